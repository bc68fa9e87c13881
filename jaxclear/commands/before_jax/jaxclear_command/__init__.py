"""The `jaxclear` command before anything is computed: which commands there are, what they may be
asked, and what is wrong with what was typed.

It is installed beside `jaxclear`, because importing that loads JAX (two seconds): a slip of the pen
is answered at once. What is computed is `jaxclear.commands`.
"""
