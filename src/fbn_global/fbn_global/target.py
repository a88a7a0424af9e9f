"""The target's place in map and body, with covariance: under the leading hypothesis, and how the others differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbn_common.lie import matrix_from_rpy, skew
from fbn_common.types import Array, Mat3, Vec3
from fbn_global.field import Field, instantiate
from fbn_global.hypotheses import Hypothesis
from fbn_global.odometry import Link, Reckoned, carry
from fbn_global.state import HEAD, Block, Kind


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """Where the target is: ``position`` in map, ``body`` in base_link, with covariances [m^2]."""

    id: int
    position: Vec3
    covariance: Mat3
    body: Vec3
    body_covariance: Mat3


def target_row(field: Field) -> int | None:
    """Row of the map's target; None without one."""
    return next((k for k, f in enumerate(field.features) if f.target), None)


def locate(h: Hypothesis, field: Field, row: int, start: Reckoned, now: Reckoned, tie: Link) -> Target:
    """The target under one hypothesis, from the vehicle's pose carried to now."""
    state = instantiate(h.state, field, np.array([row], dtype=np.int64))
    block = Block(Kind.MAP, row)
    position, covariance = state.marginal(block)
    pose, jacobian, noise = carry(state, start, now, tie)
    columns = np.r_[0:HEAD, state.columns(block)]
    joint = state.covariance[np.ix_(columns, columns)]
    rotation = matrix_from_rpy(np.ascontiguousarray(pose[3:]))
    body = rotation.T @ (position - pose[:3])
    by_pose = np.hstack([-rotation.T, skew(body) @ rpy_inverse(pose[3:])])  # (3, 6): by xyz, and by roll, pitch, yaw
    by_state = np.hstack([by_pose @ jacobian, rotation.T])
    return Target(
        field.features[row].id, position, covariance, body, by_state @ joint @ by_state.T + by_pose @ noise @ by_pose.T
    )


def rpy_inverse(rpy: Array) -> Mat3:
    """``dtheta = F d(roll, pitch, yaw)`` for the body perturbation ``R Exp(dtheta)``."""
    cr, sr = np.cos(rpy[0]), np.sin(rpy[0])
    cp, sp = np.cos(rpy[1]), np.sin(rpy[1])
    return np.array([[1.0, 0.0, -sp], [0.0, cr, sr * cp], [0.0, -sr, cr * cp]])


def blend(targets: list[Target], weights: list[float]) -> Target:
    """The first target, with covariances about it of the mixture of all."""
    first, total = targets[0], sum(weights)
    covariance, body = np.zeros((3, 3)), np.zeros((3, 3))
    for target, weight in zip(targets, weights, strict=True):
        away, turned = target.position - first.position, target.body - first.body
        covariance += weight / total * (target.covariance + np.outer(away, away))
        body += weight / total * (target.body_covariance + np.outer(turned, turned))
    return Target(first.id, first.position, covariance, first.body, body)
