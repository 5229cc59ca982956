import clsco

ball = clsco.Sphere(center=(0, 0, 280), radius=30, texture="bricks")
scene = clsco.Scene(camera=clsco.Camera(f_number=2), objects=(ball,))
frame = clsco.render_frame(scene)
frame.save("ball.png")
print(frame)
