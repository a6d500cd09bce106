"""ADD AN ALGORITHM HERE: a component with seam "algorithm": prepare, feedback, step, shift, solve, kkt."""

from nmpc_codegen.components.algorithms.real_time_iteration import RealTimeIteration

REGISTRY: dict[str, type[RealTimeIteration]] = {RealTimeIteration.name: RealTimeIteration}

__all__ = ["REGISTRY", "RealTimeIteration"]
