"""The tests' own cases (sim_cases) can be imported from beside them."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
