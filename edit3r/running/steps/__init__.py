"""The steps of a run. Each takes what is known of the scene and returns it with more filled in.

    read --> locate ---> select --> edit --> reconstruct --> refine --> judge
    photos   geometry    masks      edited   Gaussians       Gaussians  verdicts

`edit3r.running.pipeline` takes one after the other. `read` begins, with the job alone; the others
get the components of the run as `Components`. One file each, named after its step.
"""
