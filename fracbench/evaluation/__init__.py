"""How flows are judged."""
