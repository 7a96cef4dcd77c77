"""Algorithm 1: improving a skill without forgetting what it solves."""
