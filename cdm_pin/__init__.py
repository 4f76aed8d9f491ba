"""Dynamics, identification and diagnosis of cable-driven serial manipulators, on Pinocchio."""
