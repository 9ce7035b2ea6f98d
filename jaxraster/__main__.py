"""`python -m jaxraster`, the same as the command `jaxraster`."""

from .cli import main

if __name__ == "__main__":
    raise SystemExit(main())
