#version 330
// Depth alone: no colour.
void main() {}
