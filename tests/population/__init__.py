"""Flights with hidden effects in rotorpy's physics, for judging explanations."""
