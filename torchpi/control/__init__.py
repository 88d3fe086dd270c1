"""Compensators, their step in a control loop, and what keeps them within what the stage bears."""
