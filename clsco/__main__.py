"""The command line as `python -m clsco`."""

from clsco.cli.process import run

if __name__ == "__main__":
    run()
