"""The machine under diagnosis: compiled variants, command and sensor paths, inverse dynamics."""
