"""The stress suite: random and directed extreme problems, judged from outside."""
