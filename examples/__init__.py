"""Example domains, made with the public interface of cgtorch only."""
