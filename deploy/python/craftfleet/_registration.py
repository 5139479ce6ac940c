"""The environments' names in Gymnasium's registry."""

import gymnasium

NAMES = {"CraftFleet/Crafter-v1": True, "CraftFleet/CrafterNoReward-v1": False}


def register() -> None:
  """Registers them, once. Episodes are truncated by the environment itself (`length`)."""
  for name, reward in NAMES.items():
    if name not in gymnasium.registry:
      gymnasium.register(
          name,
          entry_point="craftfleet.gymnasium_env:GymnasiumEnv",
          vector_entry_point="craftfleet.vector_env:VectorEnv",
          kwargs={"reward": reward})
