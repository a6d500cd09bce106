"""ADD AN ALGORITHM HERE: a component that implements `Algorithm`: prepare, feedback, step, shift, solve, kkt."""

from collections.abc import Mapping

from nmpc_codegen.components.algorithms.adjoint_shooting import AdjointShooting
from nmpc_codegen.components.algorithms.augmented_lagrangian import AugmentedLagrangian
from nmpc_codegen.components.algorithms.kalman_filter import KalmanFilter
from nmpc_codegen.components.algorithms.moving_horizon import MovingHorizon
from nmpc_codegen.components.algorithms.real_time_iteration import RealTimeIteration
from nmpc_codegen.components.base import Algorithm

REGISTRY: Mapping[str, type[Algorithm]] = {
    RealTimeIteration.name: RealTimeIteration,
    AugmentedLagrangian.name: AugmentedLagrangian,
    AdjointShooting.name: AdjointShooting,
    MovingHorizon.name: MovingHorizon,
    KalmanFilter.name: KalmanFilter,
}

__all__ = ["REGISTRY", "AdjointShooting", "AugmentedLagrangian", "KalmanFilter", "MovingHorizon", "RealTimeIteration"]
