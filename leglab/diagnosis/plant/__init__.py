"""The machine under diagnosis: compiled variants, command and sensor paths, forces at moments."""
