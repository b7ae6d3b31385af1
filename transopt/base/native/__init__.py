"""The compiled recursions of `transopt.base.recursions`; without them BLAS does their work."""
