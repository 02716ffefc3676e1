"""The search by rounds and its judging, which one likelihood replaces."""
