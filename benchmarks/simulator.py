"""How many times faster than real time a mission is simulated: motion, sensors and records; kernels warm."""

from __future__ import annotations

import sys
import time

from fbn_sim.scenario import load_scenario, scenario_names
from fbn_sim.simulation import simulate


def real_time_factor(name: str, repeats: int = 3) -> float:
    """Seconds of the mission over seconds of CPU, the best of some runs."""
    scenario = load_scenario(name)
    simulate(scenario)  # compiles, or loads what was compiled
    best = 0.0
    for seed in range(repeats):
        begin = time.process_time()
        simulation = simulate(scenario, seed)
        best = max(best, float(simulation.truth.motion.time_s[-1]) / (time.process_time() - begin))
    return best


def main() -> int:
    """Print the factor of each scenario; the goal is 100."""
    for name in scenario_names():
        print(f"{name:20s} {real_time_factor(name):7.0f} x real time")
    return 0


if __name__ == "__main__":
    sys.exit(main())
