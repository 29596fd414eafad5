"""Models that come with bladetwin."""
