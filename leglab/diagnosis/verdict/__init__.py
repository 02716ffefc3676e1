"""Results of the diagnosis: verdict, confidence, next experiment, files."""
