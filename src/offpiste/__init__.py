"""offpiste learns how an off-road vehicle will move on the ground ahead, and plans with what it learned."""

import lazy_loader

# Public names stand in __init__.pyi; each is imported on first use, so that `import offpiste` and `--help` stay quick.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
