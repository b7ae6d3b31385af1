"""Constraint studies: one design question, many scenes, one table."""
