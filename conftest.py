"""What holds for every test: property tests repeat exactly, and compiled kernels are not timed."""

from hypothesis import settings

settings.register_profile("fbn", deadline=None, derandomize=True, max_examples=60)
settings.load_profile("fbn")
