"""The sensors: each turns the truth into records with its own errors, and stamps each with when it was measured."""
