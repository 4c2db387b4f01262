#version 330
in vec2 screen;
out vec4 colour;
void main() {
    float fade = smoothstep(0.1, 0.85, length(screen - vec2(0.5, 0.55)));
    colour = vec4(mix(vec3(0.93, 0.935, 0.94), vec3(0.76, 0.775, 0.79), fade), 1.0);
}
