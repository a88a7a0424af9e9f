"""The EKF that the dead-reckoning and the reference filter share, and its compiled kernels."""
