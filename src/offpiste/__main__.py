"""`python -m offpiste`, for `torchrun -m offpiste`."""

from offpiste.cli import main

if __name__ == "__main__":
    main()
