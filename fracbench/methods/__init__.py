"""The registry of methods, ours and peers."""
