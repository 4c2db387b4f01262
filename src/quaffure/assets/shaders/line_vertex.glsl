#version 330
// Lines through the strands' vertices, one pixel wide: hair in the shadow maps of the key light.
uniform sampler2D points;
uniform int strand_vertices;
uniform mat4 clip_from_world;
void main() {
    int i = gl_VertexID + gl_InstanceID * strand_vertices;
    int width = textureSize(points, 0).x;
    gl_Position = clip_from_world * vec4(texelFetch(points, ivec2(i % width, i / width), 0).xyz, 1.0);
}
