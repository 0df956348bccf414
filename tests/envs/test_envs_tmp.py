def test_train(random_world):
    from cellpilot.envs.arena import make_arena
    from cellpilot.learn.algorithms.ddqn_her import DDQNHER
    from cellpilot.learn.trainer import train
    from cellpilot.task import Task
    w = random_world(0,(3,3,1),noise_std_db=1.0)
    import time
    t=time.time()
    r = train(DDQNHER(episodes=20, replay_capacity=1000, replay_start=100, hidden=(16,)), Task(max_steps=20), make_arena(w), 0)
    print(time.time()-t, r.compile_s)
