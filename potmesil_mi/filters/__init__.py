"""Special effects for the finished picture."""
