"""`python -m jaxclear`: the command `jaxclear`, where its script is not on the path."""

from jaxclear_command.cli import main

if __name__ == "__main__":
    main()
