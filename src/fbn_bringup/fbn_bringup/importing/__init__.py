"""From column logs (csv) of any vehicle to the project's topics, by a mapping file."""
