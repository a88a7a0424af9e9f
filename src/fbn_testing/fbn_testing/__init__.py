"""The harness that tests FBN nodes in a context and domain of their own."""
