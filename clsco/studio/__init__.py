"""The scene editor in the browser."""
