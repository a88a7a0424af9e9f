"""One feature from its first echo on: where it is believed after each, after figure 5 of IROS 2007."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fbn_common.lie import matrix_from_quaternion
from fbn_common.types import Array, Vec3
from fbn_sim.simulation import Simulation
from fbn_testing.feature_runs import Heard, tracker_of
from fbn_tracking.geometry import anchored_point, world_point
from fbn_tracking.modes import Surroundings
from fbn_tracking.parameters import FeatureParameters
from fbn_tracking.publish import sided
from fbn_tracking.track import Track, array_pose
from fbn_tracking.window import Window

_PANELS = 12  # one an echo: until it is a feature, and its first steps as one
PASSAGE = {"mission.legs.dive.depth": 1.0, "sensors.sonar.timing.rate": 2.0}  # well over the features, as there
_LEVEL = 0.5  # m, the most that the vehicle may rise or sink meanwhile
_NEAR = 3.0  # m from a true feature to be taken for it


class Moment(NamedTuple):
    """A track right after an echo, in the window's world [m]; ``truth``: the true feature relative to the vehicle."""

    graduated: bool
    point: Vec3
    rival: Vec3 | None  # at the other elevation, while that is possible
    echoes: Array  # (n, 3): every echo, at the middle of the lobe
    truth: Vec3
    height: float  # of the vehicle in truth


def stories(heard: Heard) -> list[list[Moment]]:
    """What is believed of each track of a mission, echo by echo, until its window is cut."""
    tracker, told, windows = tracker_of(heard), dict[tuple[int, int], list[Moment]](), list[Window]()
    for step in heard.steps:
        for _, topic, record in step.logged:
            tracker.put(topic, record)
        tracker.advance(step.end_ns)
        if tracker.window is not None and (not windows or windows[-1] is not tracker.window):
            windows.append(tracker.window)  # kept, so that none has another's identity
        for track in (t for t in tracker.tracks if t.memory is None and t.detections):
            story = told.setdefault((len(windows), track.key), [])
            if not story or len(track.detections) > len(story[-1].echoes):
                story.append(_moment(windows[-1], track, tracker.parameters.feature, heard.simulation))
    return list(told.values())


def off_lobe(told: list[list[Moment]]) -> list[Moment]:
    """Of the true features seen in level flight from their first echo on, the farthest from the middle of the lobe.

    Chosen by where it truly is, not by how well it is found.
    """
    return max((story[:_PANELS] for story in told if _whole(story[:_PANELS])), key=_off_lobe)


def _whole(story: list[Moment]) -> bool:
    last = story[-1]
    near = np.hypot(*(last.point - last.truth)[:2]) < _NEAR
    level = np.ptp([moment.height for moment in story]) < _LEVEL
    return bool(near and level and last.graduated and len(story[0].echoes) == 1 and len(story) == _PANELS)


def _off_lobe(story: list[Moment]) -> float:
    return float(np.abs(story[-1].echoes[:, 2] - story[-1].truth[2]).mean())


def _moment(window: Window, track: Track, feature: FeatureParameters, simulation: Simulation) -> Moment:
    echoes = [
        world_point(*array_pose(window.T(d.index), d.look.mount), np.array([*d.z[:2], 0.0]))[0]
        for d in track.detections
    ]
    modes = [mode.point for mode in track.modes]
    point = _smoothed(window, track, feature) if track.graduated else modes[0]
    rival = modes[1] if len(modes) > 1 and not track.graduated else None
    height = float(simulation.truth.at(window.pings[window.last].stamp_ns).position[0, 2])
    truth = _nearest_truth(window, point, simulation)
    return Moment(track.graduated, point, rival, np.array(echoes), truth, height)


def _smoothed(window: Window, track: Track, feature: FeatureParameters) -> Vec3:
    """Where the tracker shows it."""
    around = Surroundings(window.estimate.poses(), window.pings, np.zeros((2, 2)), feature)
    mount = track.detections[0].look.mount
    return np.asarray(anchored_point(window.T(track.anchor), mount, sided(window, track, around))[0])


def _nearest_truth(window: Window, point: Vec3, simulation: Simulation) -> Vec3:
    """The true feature nearest to ``point``, carried along with the vehicle from where it is to where it is thought."""
    motion, T = simulation.truth.at(window.pings[window.last].stamp_ns), window.T(window.last)
    R = T[:3, :3] @ matrix_from_quaternion(motion.orientation[0]).T
    carried = T[:3, 3] + (simulation.truth.features.positions - motion.position[0]) @ R.T
    return np.asarray(carried[np.argmin(np.hypot(*(carried - point).T[:2]))])


def draw_story(story: list[Moment], target: Path) -> None:
    """y and z after each echo: the echoes at the middle of the lobe, where the feature was believed and is."""
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(3, 4, figsize=(11, 7.4), sharex=True, sharey=True)
    for number, axis in enumerate(axes.flat):
        _panel(axis, story, number)
    for axis in axes[:, 0]:
        axis.set_ylabel("z [m]")
    for axis in axes[-1]:
        axis.set_xlabel("y [m]")
    handles = {
        label: handle for axis in axes.flat for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="lower center", ncols=6, fontsize=8)
    figure.tight_layout(rect=(0.0, 0.04, 1.0, 1.0))
    figure.savefig(target, dpi=120)
    pyplot.close(figure)


def _panel(axis: Any, story: list[Moment], number: int) -> None:
    now = story[number]
    axis.plot(now.echoes[:, 1], now.echoes[:, 2], ".", color="#808080", ms=4, label="echoes, mid-lobe")
    for before in story[:number]:
        axis.plot(*before.point[1:], "x" if before.graduated else "o", color="#1f5fa8", ms=4, mfc="none", alpha=0.6)
    if now.rival is not None:
        axis.plot(*now.rival[1:], "^", color="#c08a2e", ms=6, mfc="none", label="the other elevation")
    marker, label = ("X", "feature") if now.graduated else ("o", "infant")
    axis.plot(*now.point[1:], marker, color="#1f5fa8", ms=10, mfc="none", mew=1.4, label=label)
    axis.plot(*now.truth[1:], "+", color="black", ms=11, label="truth")
    axis.set_title(f"{len(now.echoes)} echo{'es' if len(now.echoes) > 1 else ''}", fontsize=9, loc="left")
