"""Bad inputs, generated from the public surface and written by hand, and how they are answered."""
