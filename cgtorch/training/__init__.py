"""The paper's protocol: from a domain to a skill that has been tested, in stages or rounds."""
