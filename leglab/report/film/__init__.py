"""Films of runs: one, or several side by side, rendered offscreen and encoded as H.264."""

from leglab.report.film.produce import FRAME_RATE, SIZE, render_film

__all__ = ["FRAME_RATE", "SIZE", "render_film"]
