"""A page in the browser that shows skills at work in the tabletop world."""
