"""`python -m quaffure`, the same as `quaffure`."""

from quaffure.apps.cli.main import main

if __name__ == "__main__":
    main()
