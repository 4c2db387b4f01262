#version 330
in vec3 position;
in vec3 normal;
in float scalp;
uniform mat4 clip_from_world;
out vec3 world;
out vec3 surface_normal;
out float hair_cover;
invariant gl_Position;
void main() {
    world = position;
    surface_normal = normal;
    hair_cover = scalp;
    gl_Position = clip_from_world * vec4(position, 1.0);
}
