"""cgtorch: robot skills that improve themselves, as evolving computational graphs in PyTorch."""

__version__ = "0.1.0"
