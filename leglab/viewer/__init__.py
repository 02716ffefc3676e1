"""The live viewer: a controller in real time on a leg that the user breaks by hand."""
