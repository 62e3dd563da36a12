"""fracbench: fractional TV-L1 optical flow, and the harness that reproduces and checks arXiv:1512.01398."""

__version__ = "0.1.0"
