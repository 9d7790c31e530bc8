"""Shapes from elsewhere and for elsewhere: meshes of images and vessels, closed surfaces, moulds."""
