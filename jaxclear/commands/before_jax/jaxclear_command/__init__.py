"""The `jaxclear` command before anything is computed: which studies there are, what they may be
asked, and what is wrong with what was typed.

It is installed beside `jaxclear`, because importing that loads JAX (two seconds): a slip of the pen
is answered at once. The studies themselves are `jaxclear.commands`.
"""
