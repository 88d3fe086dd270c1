"""The judge's parts: run the tool, grade its answers, add them up, show them. Knows the labels, no tool."""
