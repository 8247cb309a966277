from .field import BrunetonField as BrunetonField
from .solver import Bruneton as Bruneton
