"""Independent plain-NumPy implementations that the compiled code is compared with."""
