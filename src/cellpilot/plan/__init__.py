"""Planning: routes over a known map."""
