"""Kernel machines: C-SVC and epsilon-SVR, and the two models built from them."""
