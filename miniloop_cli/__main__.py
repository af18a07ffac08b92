"""`python -m miniloop_cli` is the same program as `miniloop`."""

from miniloop_cli.cli.main import main

if __name__ == "__main__":
    main()
