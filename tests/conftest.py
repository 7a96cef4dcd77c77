"""Settings shared by every test."""

import hypothesis
import torch

torch.set_num_threads(1)
hypothesis.settings.register_profile(
    "cgtorch", deadline=None, derandomize=True, print_blob=True, max_examples=50
)
hypothesis.settings.load_profile("cgtorch")
