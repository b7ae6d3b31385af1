"""What proves an answer, from the rollout and never from the solver: certificate, Farkas ray, replay."""
