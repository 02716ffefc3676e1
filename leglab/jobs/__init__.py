"""Many pieces of work in processes beside this one, here or on a cluster."""
