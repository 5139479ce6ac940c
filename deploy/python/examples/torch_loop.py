#!/usr/bin/env python3
"""Actor-critic training in plain PyTorch, on craftfleet.VectorEnv. Needs: pip install torch

Usage: torch_loop.py [--steps=N] [--lanes=N]
  --steps=N  steps of all lanes together, default 200000
  --lanes=N  games played side by side, default 16
"""

import argparse

import craftfleet
import torch
from torch import nn

HORIZON, DISCOUNT = 16, 0.97


def new_network():
  """From uint8[n, 64, 64, 3] to 17 logits and a value."""
  return nn.Sequential(
      nn.Conv2d(3, 32, 8, 4), nn.ReLU(), nn.Conv2d(32, 64, 4, 2), nn.ReLU(), nn.Conv2d(64, 64, 3), nn.ReLU(), nn.Flatten(),
      nn.Linear(1024, 256), nn.ReLU(), nn.Linear(256, 18))


def train(envs, network, steps):
  """Trains the network; yields the steps so far and their mean reward after each update."""
  optimizer = torch.optim.Adam(network.parameters(), lr=3e-4)
  frames = torch.from_dlpack(envs.reset(seed=0)[0])  # shares the memory with copy=False: always the newest pictures

  def act():
    outputs = network(frames.permute(0, 3, 1, 2) / 255)
    return torch.distributions.Categorical(logits=outputs[:, :17]), outputs[:, 17]

  for update in range(1, steps // (HORIZON * envs.num_envs) + 1):
    log_probs, values, entropies, rewards, going = [], [], [], [], []
    for _ in range(HORIZON):
      policy, value = act()
      action = policy.sample()
      _, reward, terminated, truncated, _ = envs.step(action.numpy())
      log_probs.append(policy.log_prob(action))
      values.append(value)
      entropies.append(policy.entropy())
      rewards.append(torch.tensor(reward, dtype=torch.float32))
      going.append(1 - torch.tensor(terminated | truncated, dtype=torch.float32))
    with torch.no_grad():
      result = act()[1]
    returns = []
    for reward, goes_on in zip(reversed(rewards), reversed(going)):
      result = reward + DISCOUNT * goes_on * result
      returns.insert(0, result)
    advantages = torch.stack(returns) - torch.stack(values)
    loss = (0.5 * advantages.square() - torch.stack(log_probs) * advantages.detach() - 0.01 * torch.stack(entropies)).mean()
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), 0.5)
    optimizer.step()
    yield update * HORIZON * envs.num_envs, torch.stack(rewards).mean().item()


def main():
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--steps", type=int, default=200_000)
  parser.add_argument("--lanes", type=int, default=16)
  arguments = parser.parse_args()
  torch.manual_seed(0)
  envs = craftfleet.VectorEnv(arguments.lanes, autoreset_mode="SameStep", copy=False)
  recent = 0.0
  for update, (steps, reward) in enumerate(train(envs, new_network(), arguments.steps), 1):
    recent += reward
    if update % 20 == 0:
      print(f"{steps} steps, reward of 100 steps: {100 * recent / 20:.2f}", flush=True)
      recent = 0.0


if __name__ == "__main__":
  main()
