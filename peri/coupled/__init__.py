"""Physics joined: a dissolving metal and the liquid that takes up what it releases."""
