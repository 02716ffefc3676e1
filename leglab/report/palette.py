"""Colours of all figures and films; nothing to import."""

# Okabe and Ito 2008, Color Universal Design: told apart under all common colour blindness.
BLUE = "#0072B2"
ORANGE = "#E69F00"
VERMILION = "#D55E00"
BLACK = "#000000"
LIGHT_GREY = "#B8B8B8"
DARK_GREY = "#4D4D4D"
# Runs and controllers beside each other, in this order; vermilion marks what changes.
SERIES = (BLACK, BLUE, ORANGE, "#009E73", "#CC79A7", "#56B4E9")
