"""Is a log good enough to navigate by: topics, rates, gaps, stamps, and values that look wrong."""
