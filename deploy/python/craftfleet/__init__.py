"""CraftFleet for Python: the game Crafter, native and exact, with seeds that repeat.

    import craftfleet
    env = craftfleet.Env(seed=1)                                # in place of crafter.Env
    env = gymnasium.make("CraftFleet/Crafter-v1")               # Gymnasium
    envs = craftfleet.VectorEnv(64, threads=4)                  # many games in one array
    run = craftfleet.train(steps=100_000, logdir="runs/first")  # the programs of CraftFleet
"""

try:
  from craftfleet import _engine
except ImportError as error:
  raise ImportError(
      f"{error}. In the folder with the package's source, Python finds the source instead of the installed package: start it "
      f"in another folder. If craftfleet is not installed: pip install ./deploy/python") from None
import gymnasium

from craftfleet.env import Env
from craftfleet.gymnasium_env import GymnasiumEnv
from craftfleet.policy import Policy
from craftfleet.recorder import Recorder
from craftfleet.remote import RemoteVectorEnv, Tls
from craftfleet.runs import Score, load_curves, load_weights, score
from craftfleet.training import Run, evaluate, train
from craftfleet.vector_env import VectorEnv

__all__ = [
    "ACHIEVEMENTS", "ACTIONS", "ITEMS", "Env", "GymnasiumEnv", "Policy", "Recorder", "RemoteVectorEnv", "Run", "Score", "Tls",
    "VectorEnv", "evaluate", "load_curves", "load_weights", "score", "train"
]
__version__ = "0.2.0"

ACTIONS: tuple[str, ...] = _engine.ACTIONS  # by number
ITEMS: tuple[str, ...] = _engine.ITEMS  # of the inventory
ACHIEVEMENTS: tuple[str, ...] = _engine.ACHIEVEMENTS

# Episodes are truncated by the environment itself (`length`).
for _name, _reward in {"CraftFleet/Crafter-v1": True, "CraftFleet/CrafterNoReward-v1": False}.items():
  if _name not in gymnasium.registry:
    gymnasium.register(
        _name, entry_point="craftfleet.gymnasium_env:GymnasiumEnv", vector_entry_point="craftfleet.vector_env:VectorEnv",
        kwargs={"reward": _reward})
