"""The processes of heliograph, one package each; they share messages, never code."""
