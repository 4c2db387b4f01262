#version 330
out vec2 screen;
void main() {
    screen = vec2(float(gl_VertexID % 2), float(gl_VertexID / 2)) * 2.0;
    gl_Position = vec4(screen * 2.0 - 1.0, 0.0, 1.0);
}
