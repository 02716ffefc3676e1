"""The page that lists what lies below a folder."""
