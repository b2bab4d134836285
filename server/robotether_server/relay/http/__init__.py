"""What every part of the relay needs of HTTP and WebSockets. Imports nothing else of the relay."""
