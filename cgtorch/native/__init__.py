"""Compiled code of the hot paths. Without a C compiler, torch computes all but arms' kinematics."""

from cgtorch.native.library import VECTOR as VECTOR
from cgtorch.native.library import WRONG_GRAPHS as WRONG_GRAPHS
from cgtorch.native.library import agree as agree
from cgtorch.native.library import alike as alike
from cgtorch.native.library import available as available
from cgtorch.native.library import constants as constants
from cgtorch.native.library import function as function
from cgtorch.native.library import required as required
from cgtorch.native.library import structure as structure
from cgtorch.native.library import suits as suits
from cgtorch.native.library import threads as threads
from cgtorch.native.library import threads_worth as threads_worth
from cgtorch.native.library import use_threads as use_threads
