"""What is checked of every record at the door: finite, and covariances that are such."""

from __future__ import annotations

import numpy as np

from fbn_common.records import CompositeMeasurement, Datum, Odometry, Record, ReferenceFix
from fbn_common.types import Array


def refusal(record: Record) -> str:
    """Why a record can't be used; empty if it can (composites are looked into further when taken apart)."""
    if isinstance(record, Odometry):
        return _odometry(record)
    if isinstance(record, ReferenceFix):
        return (
            ""
            if np.isfinite(record.xy).all() and _definite(record.covariance) and _definite(record.marginal)
            else "not a finite fix with covariance"
        )
    if isinstance(record, Datum):
        good = abs(record.latitude) <= 90.0 and abs(record.longitude) <= 180.0 and bool(np.isfinite(record.height))
        return "" if good else "no place on earth"
    if isinstance(record, CompositeMeasurement):
        return _swept(record)
    return f"unwanted record {type(record).__name__}"


def _odometry(record: Odometry) -> str:
    pose = record.pose
    if not (np.isfinite(pose.position).all() and np.isfinite(pose.orientation).all()):
        return "pose is not finite"
    if abs(float(pose.orientation @ pose.orientation) - 1.0) > 1e-3:
        return "orientation is not a unit quaternion"
    if not np.isfinite(record.pose_covariance).all() or (np.diag(record.pose_covariance) < 0.0).any():
        return "pose covariance is not finite and positive"
    if not (np.isfinite(record.twist).all() and np.isfinite(record.twist_covariance).all()):
        return "twist is not finite"
    return ""


def _swept(record: CompositeMeasurement) -> str:
    area = record.swept
    if len(area.scans) != area.width * area.height or not area.cell_size > 0.0:
        return f"swept area of {area.width} x {area.height} cells has {len(area.scans)}"
    if not (np.isfinite(area.scans).all() and np.isfinite(area.origin).all()) or (np.asarray(area.scans) < 0.0).any():
        return "swept area is not finite and positive"
    return ""


def _definite(matrix: Array) -> bool:
    """Whether a matrix is finite, symmetric and positive definite."""
    if not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-12):
        return False
    return bool(np.linalg.eigvalsh(matrix)[0] > 0.0)
