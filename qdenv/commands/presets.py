"""The command presets."""

from qdenv.domains.base import make_domain
from qdenv.presets import PRESETS


def presets() -> None:
    """List the presets with their main numbers."""
    for name, preset in PRESETS.items():
        evaluation, domain = preset.evaluation, make_domain(preset.evaluation.domain)
        rows, cols = domain.shape
        fleet = getattr(domain.config, "fleet", domain.config)
        agents = getattr(fleet, "agents", 1)
        print(
            f"{name:20} {domain.name:17} {rows}x{cols}, agents {agents}, T {fleet.timesteps}, "
            f"alpha {evaluation.alpha:g}, evaluations {preset.evaluations}"
        )
