"""Speed and accuracy beside their peers: measured in one go, kept over commits, checked."""
