"""HTTP and WebSocket helpers for every part of the relay. Imports nothing else of the relay."""
