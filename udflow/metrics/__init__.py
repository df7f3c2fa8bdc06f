"""How good is a mesh: exact distances, sampled measures beside their floors, topology."""

from udflow.metrics.evaluation import Evaluation as Evaluation
from udflow.metrics.evaluation import evaluate as evaluate
from udflow.metrics.protocols import PROTOCOLS as PROTOCOLS
from udflow.metrics.protocols import ProtocolResult as ProtocolResult
from udflow.metrics.protocols import evaluate_protocol as evaluate_protocol
