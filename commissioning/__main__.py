"""`python -m commissioning` is `tworelay`."""

from commissioning.cli import main

if __name__ == "__main__":
    main()
