"""Proofs of an answer from its rollout, independent of the solver: certificate, Farkas ray, replay."""
