"""How good a run was: errors against truth, consistency, matches, and what can be said without truth."""
