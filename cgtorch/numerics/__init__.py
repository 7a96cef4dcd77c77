"""Arithmetic that is equal on every device, random numbers drawn from counters, intervals."""

from cgtorch.numerics.functions import atan2 as atan2
from cgtorch.numerics.functions import row_means as row_means
from cgtorch.numerics.functions import sigmoid as sigmoid
