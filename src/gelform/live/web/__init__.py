"""The server: requests, websockets, and who may make them."""
