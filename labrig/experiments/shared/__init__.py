"""shared: what two experiments have in common, and no room below is the place for."""
