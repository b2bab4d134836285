"""An operator's WebSocket joined to a robot's rosbridge: every message checked and written anew."""
