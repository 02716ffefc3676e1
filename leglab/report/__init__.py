"""What a run looks like: figures, videos, pages."""
