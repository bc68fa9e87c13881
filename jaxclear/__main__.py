"""`python -m jaxclear`: the command `jaxclear`, where its script is not on the path."""

import sys

from jaxclear_command.cli import main

if __name__ == "__main__":
    sys.exit(main())
