"""Where everything is: the state, the error state, the motions and the measurements as the kernels see them.

The state ``x`` is one flat array: position 3 (world) | rotation 9 (R_world_base, row-major) | velocity 6 |
parameters 15 | deviation 5 | steady water 2 | top layer's water 2.  The error state has position 3 (world), rotation 3
(body), velocity 6, angular actuation 3, damping 6, linear actuation 3, water velocity 3, deviation 5, steady water 2,
top layer 2, then considered states of zero mean.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from fbn_common.records import Odometry, PredictedMotion
from fbn_common.types import Array

IntArray = npt.NDArray[np.int64]

GRID_NS: Final = 10_000_000  # predict's step: 100 Hz, stamps are multiples of it
SNAPSHOT_NS: Final = 3 * GRID_NS  # a snapshot of the filter, and a line of odometry: 33 Hz

# the state x
X_ROTATION: Final = 3
X_VELOCITY: Final = 12
X_PARAMETERS: Final = 18
X_DEVIATION: Final = 33
X_STEADY: Final = 38
X_LAYER: Final = 40
X_SIZE: Final = 42

# the error state
POSITION: Final = 0
ROTATION: Final = 3
VELOCITY: Final = 6
ACTUATION: Final = 12  # angular; the 15 parameters start here
DAMPING: Final = 15
THRUST: Final = 21
WATER: Final = 24  # as it is now; it wanders about its steady part
OWN: Final = 27  # from here on: errors of sensors and surface, which decorrelate to zero mean
DEVIATION: Final = 27  # of yaw: constant, sine and cosine of the heading, sine and cosine of twice that [rad]
STEADY: Final = 32  # what the water returns to, east, north [m/s]; it stays
LAYER: Final = 34  # water of the top layer less that below, east, north [m/s]
LOSS: Final = 36  # considered: share of thrust lost at the surface
TILT: Final = 37  # considered: of the compass about body x and y [rad]
DEPTH: Final = 39  # considered: bias of depth [m]
GPS: Final = 40  # considered: the correlated part of a fix, in units of its standard deviation
SIZE_DEADRECK: Final = 40
SIZE_REFERENCE: Final = 42
ESTIMATED_DEADRECK: Final = 15
ESTIMATED_REFERENCE: Final = 36

# the numbers of a predicted motion: where its fields begin
_MOTION = PredictedMotion.layout
M_PARAMETERS: Final = _MOTION["parameters"].start  # increment, rotation vector, velocity at start and at end before
M_ATTITUDE: Final = _MOTION["attitude_start"].start
M_BY_VELOCITY: Final = _MOTION["jacobian_velocity"].start
M_BY_ATTITUDE: Final = _MOTION["jacobian_attitude"].start
M_BY_PARAMETERS: Final = _MOTION["jacobian_parameters"].start
M_NOISE: Final = _MOTION["noise"].start
MOTION_SIZE: Final = _MOTION["noise"].stop

# the numbers of odometry
_ODOMETRY = Odometry.layout
O_ORIENTATION: Final = 3  # of the pose: the position comes before
O_POSE_COVARIANCE: Final = _ODOMETRY["pose_covariance"].start
O_VELOCITY: Final = _ODOMETRY["twist"].start
O_TWIST_COVARIANCE: Final = _ODOMETRY["twist_covariance"].start
ODOMETRY_SIZE: Final = _ODOMETRY["twist_covariance"].stop

DATA_SIZE: Final = 18
OUT_SIZE: Final = 10


class Kind(IntEnum):
    """Kinds of items in the timeline."""

    COMPASS = 0  # data: R_world_base 9, covariance 9 (fixed axes)
    DEPTH = 1  # z of the sensor, variance
    CLIMB = 2  # altitude along the beam, its variance, slope of the bottom, baseline [s], least cosine of tilt
    POSITION = 3  # x, y of the antenna, covariance xx, xy, yy
    RANGE = 4  # beacon x, y, z, range, variance, whether linearised at: x, y of the transducer
    PARAMETERS = 5  # handled outside the kernels


class Reason(IntEnum):
    """Why the kernels gave the verdict they gave."""

    NONE = 0
    GATE = 1
    RULE = 2  # a fix no better than the filter's own position
    UNDER_WATER = 3
    DROPPED = 4  # a beacon that disagreed too often
    RESET = 5  # used after its gate was reset
    SINGULAR = 6  # innovation covariance not positive definite
    BASE = 7  # an altitude kept as the base of the next vertical speed
    TILTED = 8  # the altimeter does not look down


class Motions(NamedTuple):
    """A ring of predicted motions by grid step; row ``(stamp / GRID_NS) % capacity``."""

    stamp: IntArray  # (n,) end of the step, 0 = empty
    mean: Array  # (n, 18) increment 3, rotation vector 3, velocity at start 6, velocity at end 6
    attitude: Array  # (n, 9) R_world_base at start, as used
    parameters: Array  # (n, 15) as used
    jacobian: Array  # (n, 12, 24) by rotation 3, velocity 6, parameters 15
    noise: Array  # (n, 12, 12)


class Events(NamedTuple):
    """Measurements: a ring of slots, and the order in which they are to be processed."""

    order: IntArray  # slots sorted by (stamp, rank of topic, arrival)
    stamp: IntArray
    kind: IntArray
    sensor: IntArray
    data: Array  # (n, DATA_SIZE)
    verdict: IntArray
    reason: IntArray
    dof: IntArray
    nis: Array
    innovation: Array  # (n, 3)
    sigma: Array  # (n, 3)
    xy: Array  # (n, OUT_SIZE) of position kinds: x, y, Pxx, Pxy, Pyy before and after


class Snapshots(NamedTuple):
    """A ring of filter states at multiples of SNAPSHOT_NS; everything stamped up to then is in them."""

    stamp: IntArray
    x: Array  # (n, X_SIZE)
    covariance: Array  # (n, size, size)
    sensors: Array  # (n, sensors, SENSOR_SIZE)


class Config(NamedTuple):
    """Numbers the kernels need; see the parameter classes for units and origin."""

    estimated: int  # error states up to here are estimated; the rest is considered
    corrects: IntArray  # (kinds, 2) first and last + 1 of the error states that a kind of measurement corrects
    snapshot_ns: int
    walk: Array  # (15,) power spectral density of the parameters' random walks
    limit: Array  # (15,) variance above which the walk of a parameter stops
    water_share: float  # spectral density of the steady water's walk over its mean square [1/s]
    wander: float  # variance of the water about its steady part over that part's mean square
    wander_time: float  # s, correlation time of that
    tau: Array  # (15,) correlation time of the states from OWN on [s]
    variance: Array  # (15,) their stationary variance
    dip: float  # inclination of the earth's magnetic field [rad]
    wave_acceleration: float  # standard deviation at the surface [m/s^2]
    wave_depth: float  # depth over which it falls by e [m]
    surface_depth: float  # m, above which thrust is lost
    layer_depth: float  # m, over which the top layer's own motion falls by e
    depth_scale: float  # uncertainty of density, as a share of depth, over the bias's standard deviation [1/m]
    gate: Array  # (4, kinds) NIS gate by degrees of freedom and kind
    lockout: Array  # (kinds,) consecutive consistent outliers after which the gate resets
    lever: Array  # (kinds, 3) of the sensor in base_link [m]
    white: float  # least share of a fix's variance that is independent from fix to fix
    correlated: float  # most of a fix's variance that is not [m^2]
    fix_depth: float  # m, deeper than this no fix is believed
    rule: bool  # GPS rule on
    drop_s: float  # s, for how long a beacon that lies is not listened to


# columns of a sensor's row
GATED_RUN: Final = 0  # consecutive consistent outliers
LAST: Final = 1  # its last gated innovation, 3
LAST_USED: Final = 4  # s, stamp
DROPPED_UNTIL: Final = 5  # s, stamp
ALTITUDE: Final = 6  # m, base of the next vertical speed
ALTITUDE_TIME: Final = 7  # s, its stamp
SENSOR_SIZE: Final = 8

# rows of sensors
COMPASS_ROW, DEPTH_ROW, CLIMB_ROW, GPS_ROW, BEACON_ROW = 0, 1, 2, 3, 4  # beacons from there on
