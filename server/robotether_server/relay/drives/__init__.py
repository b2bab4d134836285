"""What a drive came to, for its record."""
