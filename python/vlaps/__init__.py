"""MetaDrive's driving task as fast Gymnasium environments; each seed is one episode.

>>> import gymnasium, vlaps
>>> env = gymnasium.make("vlaps/MetaDrive-c29cc37-v0", start_seed=1000, num_scenarios=50)
>>> observation, info = env.reset(seed=1000)
>>> observation.shape
(259,)
>>> observation, reward, terminated, truncated, info = env.step([0.0, 0.5])
>>> info["cost"]
0.0
"""

from ._vlaps import RecordingError, State, __version__
from .config import DEFAULTS
from .dataset import Dataset, Recorded, collect
from .env import MetaDriveEnv
from .evaluation import Episode, Evaluation, evaluate
from .policy import Policy, export
from .recording import Attachment, Message, Recording, Topic
from .registration import ENV_ID, register
from .takeover import Takeover
from .vector import MetaDriveVectorEnv
from .window import write_video

register()

__all__ = [
    "Attachment",
    "DEFAULTS",
    "Dataset",
    "ENV_ID",
    "Episode",
    "Evaluation",
    "MetaDriveEnv",
    "MetaDriveVectorEnv",
    "Message",
    "Policy",
    "Recorded",
    "Recording",
    "RecordingError",
    "State",
    "Takeover",
    "Topic",
    "__version__",
    "collect",
    "evaluate",
    "export",
    "write_video",
]
