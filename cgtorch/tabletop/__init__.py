"""The paper's domain: a robot that reaches objects on a table (section VI)."""
