"""Search for the sets of effects that explain recordings: a beam, and fits by replays."""
