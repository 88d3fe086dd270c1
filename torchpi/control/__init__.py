"""Compensators, their step in a control loop, and the guard that keeps them within what the stage bears."""
