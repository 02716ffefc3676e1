"""From settings to results: one closed loop, its metrics and files, and many of them."""
