"""Domains of one's own, made with nothing but the public interface of cgtorch."""
