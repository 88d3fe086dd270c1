"""What keeps a compensator in a control loop within what it was trained on and what the stage bears."""
