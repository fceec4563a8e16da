"""The oracle: planning, grounding, acting, and deliberate mistakes."""
