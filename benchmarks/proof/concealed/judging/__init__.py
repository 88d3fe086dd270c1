"""The judge: grades answers and adds the grades up. It knows the labels, but no tool."""
