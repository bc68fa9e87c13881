"""jaxclear beside other programs, at equal accuracy."""
