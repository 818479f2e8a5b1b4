"""From a spec to a mesh and to a solid, each with a certificate."""
