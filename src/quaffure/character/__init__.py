"""A skinned character of a file as a body: skeleton, skin, collision surface and scalp."""
