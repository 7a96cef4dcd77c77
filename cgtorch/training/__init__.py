"""The paper's protocol: from a domain to a tested skill, in stages or rounds."""
