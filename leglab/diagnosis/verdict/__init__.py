"""What the diagnosis says: verdict, confidence, next experiment, files."""
