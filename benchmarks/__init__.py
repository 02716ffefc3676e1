"""How fast and how right leglab is: scripts that measure, and what they share."""
