"""Solvers behind one function, `choose.solve(problem, options) -> Solution`. One file per solver."""
